"""Contact of a cloth with itself: vertex against triangle, edge against edge."""
