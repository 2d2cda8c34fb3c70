"""Images come in here, and every one is a `Frame`: cameras, network streams, videos, folders of images.

openable.py      Openable: opened, and closed however its use ends
source.py        FrameSource, what all members of the family honour; wrench_source.py: WrenchSource, the same of forces
camera.py        Camera (UVC through V4L2), settings.py what it is set to and how that is read back
raspberry_pi.py  RaspberryPi (ribbon cable, through picamera2)
stream.py        Stream (MJPEG or RTSP over the network)
files.py         VideoFile, ImageFolder; image_list.py ImageList, images that were named one by one
freshest.py      Freshest(source): the newest image, never a stale one
as_if_now.py     AsIfNow(source): a recording at its own pace, stamped when it is read
reconnecting.py  Reconnecting(source): survives an unplugged cable; returning.py how a device is waited for
address.py       source_for("0" | "/dev/video0" | URL | FILE | FOLDER)
force_torque/    force/torque sensors: Bota, ATI, OnRobot, serial; tared, mounted, watched
sampling_rule.py which moments of a contact are worth keeping
images.py      read_image, average_images
rate.py          measure_rate: what a source really delivers
devices.py       which cameras this machine has; checkup.py examines one
"""
