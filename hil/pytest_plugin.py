"""Fixtures and markers for bench tests."""
