"""The robot protocol that executes actions, and its implementations."""
