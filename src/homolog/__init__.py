"""Homolog."""
