"""Pictures of a height map: in false colours for a live view, and as a map and a relief for people to read."""

from ninedtact.shape.picture.map import height_picture
from ninedtact.shape.picture.palette import ColourScale, colourise, scale_for
from ninedtact.shape.picture.relief import shaded_picture

__all__ = ["ColourScale", "colourise", "height_picture", "scale_for", "shaded_picture"]
