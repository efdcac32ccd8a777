"""Box2D, for contacts only: a batch of few bodies, and two backends that step it with the same results."""

import warnings

with warnings.catch_warnings():  # its types have no __module__; where that warning is an error, the import crashes
    warnings.simplefilter("ignore")
    import Box2D  # ahead of all other modules that import it

VERSION: str = Box2D.__version__  # "2.3.10" of the package Box2D, "2.3.10.5" of ufal-pybox2d, which has the same code
