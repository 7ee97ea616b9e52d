"""Step programs and the machine code made from them; the only place that knows llvmlite.

Nothing here knows a filter or a model: a program is composed by running their ordinary methods on
graph nodes. Without llvmlite (the ``fast`` extra) everything else works, on arrays.
"""
