"""What one control cycle is made of: devices read, data judged, aligned, decided on, sent."""
