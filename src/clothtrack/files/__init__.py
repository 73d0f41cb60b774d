"""Files as all rooms write them: whole or not at all, with the settings they were made with."""
