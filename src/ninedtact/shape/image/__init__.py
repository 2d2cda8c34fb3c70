"""Images of a height map: in false colours for a live view, and as a map and a relief for people to read."""

from ninedtact.shape.image.map import height_image
from ninedtact.shape.image.palette import ColourScale, colourise, scale_for
from ninedtact.shape.image.relief import shaded_image

__all__ = ["ColourScale", "colourise", "height_image", "scale_for", "shaded_image"]
