"""Saying where a page is, and opening it."""

import threading
import webbrowser


def announce(text: str, address: str, browser: bool = True) -> None:
    """Print what is to be seen at an address, and open it in a browser unless that is not wanted."""
    print(text, flush=True)
    if browser:
        threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()  # some wait for their browser
