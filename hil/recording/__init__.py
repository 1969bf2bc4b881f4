"""Recordings in and out: MCAP, rosbag2, the public CSV pairs, plain CSV."""
