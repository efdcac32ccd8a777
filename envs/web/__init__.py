"""Web pages that need no network: replays of recordings, and play in the browser."""
