"""MicroStrain (HBK) 3DM-CV7 and 3DM-GV7: inertial units that speak the public MIP protocol, serially."""
