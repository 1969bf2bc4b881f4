"""Utilities that do not depend on robots: files, signals, progress, machine code."""
