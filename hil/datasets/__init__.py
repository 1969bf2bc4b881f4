"""Data sets for calibration: wheel logs and ground truth, read from CSV and bags, checked and repaired."""
