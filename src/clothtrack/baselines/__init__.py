"""What is only compared with: none of it is part of the method."""
