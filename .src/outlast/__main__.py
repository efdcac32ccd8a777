"""python -m outlast: the command line."""

import sys

from .envs.main import main

sys.exit(main())
