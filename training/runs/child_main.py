"""A run as a child of `outlast train`, by python -m and the words of the command. It saves and ends with its parent."""

import _thread
import os
import signal
import sys
import threading

from outlast.envs.cli.main import main


def end_with_parent() -> None:
    """Interrupt this process, as Ctrl-C does, when the parent ends in whatever way: standard input, its pipe, closes.

    Shells let background commands and their children ignore SIGINT. It is handled again, or nobody could stop a run.
    """
    signal.signal(signal.SIGINT, signal.default_int_handler)

    def watch() -> None:
        while os.read(sys.stdin.fileno(), 1024):  # sys.stdin.read would hold a lock that aborts Python's exit
            pass
        _thread.interrupt_main()

    threading.Thread(target=watch, daemon=True).start()


if __name__ == "__main__":
    end_with_parent()
    sys.exit(main())
