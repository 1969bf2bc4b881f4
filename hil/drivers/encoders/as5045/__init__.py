"""Four AS5045 encoders behind a CAN node."""
