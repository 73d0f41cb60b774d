"""The network that is told its garment: tokens of the rest mesh attend to the picture."""
