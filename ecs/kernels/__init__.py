"""Tools of compiled code: numba's settings, types of arrays, vectors, random numbers, files of machine code.

Nothing here depends on components or worlds. `jit.kernel` marks functions that systems call, `simd` computes with
sixteen rows at once, and `random` draws numbers that are functions of seed, world, episode, tick and stream. `errors`
has the exceptions of the engine.
"""
