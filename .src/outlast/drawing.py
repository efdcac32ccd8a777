"""Layers of pictures and films: those of outlast, and what layers of one's own are made of.

>>> from outlast.drawing import Canvas, Layer, Scene, ZOrder

A layer is a class with a method `draw(self, canvas, scene)`: it reads one world and draws on a canvas, in metres.
`outlast.draw`, `outlast.film` and --views take instances. `drawing.pyi` lists what there is.
"""

from ._lazy import attach as _attach

__getattr__, __dir__, __all__ = _attach(__name__, __file__)
