"""The emulated motion capture server (OptiTrack Motive, NatNet)."""
