"""Slow, short and plain: the executable specification of every compiled kernel.

Nothing here imports a kernel. A *run* is a list of ``(action, response)`` pairs, response -1 where none was seen.
"""
