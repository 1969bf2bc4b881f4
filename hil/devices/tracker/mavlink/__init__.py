"""Any visual-inertial computer that sends MAVLink `ODOMETRY`, by UDP or serial, and its emulation."""
