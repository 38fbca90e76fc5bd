"""A matcher that needs no weights, in a module that other processes can import."""

from homolog.matching import Matcher
from homolog.pairs import MatcherSettings


def axiomatic():
    return Matcher(settings=MatcherSettings(method="axiomatic"))
