"""MicroStrain (HBK) 3DM-CV7 and 3DM-GV7 on a serial port."""
