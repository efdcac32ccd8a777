"""Box2D, for contacts only: a scene of few bodies, and two bridges that step it with the same results."""
