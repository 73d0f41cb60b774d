"""From one depth picture to the whole mesh, hidden layers included (needs the extra [learn])."""
