"""``pip`` as the blocks of pages call it in tests: installs nothing, but what is to be installed must exist.

Of the checkout (``.``) and of ``homolog`` that is: the extras in brackets.
"""

import re
import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]

asked, *wanted = sys.argv[1:]
assert asked == "install" and wanted, sys.argv
for each in wanted:
    named = re.fullmatch(r"(\.|homolog)(?:\[([\w,-]+)\])?", each)
    assert named, f"pip install {each}"
    missing = set(filter(None, (named[2] or "").split(","))) - set(PROJECT["optional-dependencies"])
    assert not missing, f"pip install {each}: no extras {missing}"
