"""For tests of executors: one that sends everything through pickles, and work for processes that may die.

Little is imported here, since every process that does the work imports it too.
"""

import os
import pickle
import signal
import time
from concurrent.futures import Executor, Future

import numpy as np

from models.errors import located


class Pickling(Executor):
    """Calls at once what comes out of a pickle of what was submitted, and pickles the answer.

    Plain pickles hold functions by name: a closure, a lambda or an object with a lock fails here as it would on the
    way to another process.

    Attributes
    ----------
    sent : list of int
        Bytes of each submission.
    """

    def __init__(self) -> None:
        self.sent = []

    def submit(self, fn, /, *args, **kwargs):
        content = pickle.dumps((fn, args, kwargs))
        self.sent.append(len(content))
        promise = Future()
        try:
            work, given, keywords = pickle.loads(content)
            promise.set_result(pickle.loads(pickle.dumps(work(*given, **keywords))))
        except Exception as error:
            promise.set_exception(pickle.loads(pickle.dumps(error)))
        return promise


def drawn(seed, index):
    """What a piece has to be: a function of its own seed and nothing else."""
    return float(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7, index))).normal())


def fails_at(bad, index):
    if index == bad:
        raise located("file.csv, line 3", index, "another number")
    return index


def dies_once(folder, index):
    """Kill the process that does piece 2, the first time."""
    flag = folder / "died"
    if index == 2 and not flag.exists():
        flag.write_text("yes")
        os.kill(os.getpid(), signal.SIGKILL)
    return drawn(1, index), os.getpid()


def dies(index):
    os.kill(os.getpid(), signal.SIGKILL)


def slow(index):
    time.sleep(0.2)
    return index
