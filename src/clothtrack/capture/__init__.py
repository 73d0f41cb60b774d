"""Making a recording: filming, the camera's pose, which pixels are cloth, where the picker is."""
