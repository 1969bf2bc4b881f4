"""Tracking cameras."""
