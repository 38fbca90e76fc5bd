"""``python -m homolog``."""

from homolog.cli.main import main

main()
