"""python -m outlast: the command line."""

import sys

from .envs.cli.main import main

sys.exit(main())
