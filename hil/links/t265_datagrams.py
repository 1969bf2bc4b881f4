"""Format of the datagrams that carry the poses of an emulated T265 between processes; both ends use it.

Little endian, each starts with `FEED_MAGIC` and a kind byte: `FEED_SUBSCRIBE` and `FEED_LEAVE` (client to
camera, nothing more), `FEED_SETTINGS` (client to camera: JSON, `options` by librealsense's names and the
`wheels` calibration), `FEED_WHEELS` (client to camera: `WHEELS_RECORD`), `FEED_INFO` (`INFO_RECORD`) and
`FEED_POSE` (`POSE_RECORD`), in the camera's own axes and on its own clock.
"""

import struct

FEED_MAGIC = b"HP1"
FEED_SUBSCRIBE, FEED_LEAVE, FEED_INFO, FEED_POSE, FEED_SETTINGS, FEED_WHEELS = 1, 2, 3, 4, 5, 6
FEED_HEAD = struct.Struct("<3sB")
INFO_RECORD = struct.Struct("<3sB32s32s32s")
"""Magic, kind, name, serial number, firmware: UTF-8, padded with zeros."""
POSE_RECORD = struct.Struct("<3sBQd13dB")
"""Magic, kind, frame number, timestamp ms, translation m, velocity m/s, rotation x y z w,
angular velocity rad/s, tracker confidence."""
WHEELS_RECORD = struct.Struct("<3sBBQ3d")
"""Magic, kind, sensor, frame number, velocity m/s in the sensor's axes."""
