"""The token network, which is given its garment: tokens of the rest mesh attend to the picture."""
