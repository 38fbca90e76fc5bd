"""Servers of pages: one that matches what is dropped on it, and one that shows a match.

The server that matches is ``homolog.serving.server``, and needs the extra ``serve``.
"""

from homolog.serving.command import MatchCommand
from homolog.serving.limits import Limits
from homolog.serving.page_server import PageServer

__all__ = ["Limits", "MatchCommand", "PageServer"]
