"""The emulated steering encoders: four AS5045 chips and the CAN node that reads them."""
