"""Reports: stills, overlay videos, and offline pages."""
