"""Printing the address of a page, and opening it."""

import sys
import threading
import webbrowser

from ..progress import Messages


def announce(text: str, address: str, browser: bool = True) -> None:
    """Print a text about a page, and open the page's address if a `browser` is wanted."""
    print(text, file=Messages(sys.stdout), flush=True)
    if browser:
        # in a thread, as some calls wait for the browser to close
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()
