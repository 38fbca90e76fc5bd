"""A page that matches what is dropped on it. The server itself is ``homolog.serving.server``, and needs an extra."""

from homolog.serving.command import MatchCommand
from homolog.serving.limits import Limits

__all__ = ["Limits", "MatchCommand"]
