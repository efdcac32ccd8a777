"""outlast: thousands of 2-D multi-agent survival worlds, advanced together."""

__version__ = "0.1.0"
