"""Look at what happened: stills, overlay video, one offline page."""
