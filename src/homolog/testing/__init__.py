"""What methods promise, as functions that check it: yours and those of Homolog pass the same ones."""

from homolog.testing.method_checks import check_method

__all__ = ["check_method"]
