"""What carries actions out: a protocol, and the robots behind it."""
