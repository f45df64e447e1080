"""Smoothers: laws of past states given all measurements."""
