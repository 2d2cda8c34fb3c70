"""Height of the skin from a camera frame, and what is derived from it. In: a `Frame`, a sensor's lens model and depth curve, and
the reference image of the session (no contact). Out: a `HeightMap`; from it, a `ShapeSummary`, a point cloud, a mesh, a file or an
image for display.

The path of one frame is `lens_and_rectification` (raw image to the skin's square grid), then `depth` (brightness to height).
`calibrated_shape.CalibratedShape` holds both for one sensor. `skin_identity` and `image_plausibility` tell whether an image is
one of this sensor.
`orthorectification` moves heights from lines of sight to places on the skin, `surface` reduces a height map to a few numbers and
makes points and triangles, `export` writes files, and `coloured_height_map` draws.
"""
