"""Lets `python -m murmurate` do what the command `murmurate` does."""

import sys

from murmurate.cli.main import main

sys.exit(main())
