"""The software of the 9DTact tactile sensor: camera images in, shape in mm and force in N out.

    shape    light ──capture──▶ Frame ──rectify──▶ Rectified ──depth──▶ HeightMap ──cloud──▶ PointCloud / mesh
    force    Reading ──estimator──▶ WrenchEstimate      by physics or by a network
    fit      board image ──▶ Rectification      ball image ──▶ DepthCurve and the sensor's twin
    press    object ──contact mechanics──▶ Contact ──light──▶ Frame, Wrench      (the twin: SimulatedCamera)

`sensor.py` is the file to read first. The public names are listed in `__init__.pyi`; each is loaded when it is first used, so
that importing the package costs nothing.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
