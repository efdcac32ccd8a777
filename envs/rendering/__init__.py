"""Pictures of worlds, without a display: layers drawn on a canvas, text, windows, films."""
