"""Fudenberg, Rand & Dreber (2012): a noisy repeated prisoner's dilemma of real people as an event log.

The data are not part of this project. They are (c) American Economic Association, CC BY 4.0, and are taken from
the R package stratEst at a fixed commit; the conversion below is this project's own.

Every period t of a match gives event 2t, ``robot_needs_help / no_signal / own choice`` (cooperating is helping),
and event 2t + 1, ``human_needs_help / partner's act / none``. The partner's act in period t is on record as
`last.other` of period t + 1, so a match of n periods has 2n - 1 events. `choice` is the intended choice (it
differs from the next period's `last.choice` about as often as the error rate says); whether `last.other` is the
partner's realised or intended act is not settled.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from models.compiled import cache_folder
from models.errors import InputError, located
from models.events import EventLog
from models.protocol import PUBLISHED, Protocol

STUDY = "fudenberg_rand_dreber_2012"
FILE_NAME = "data.FRD2012.rda"
EVENTS_NAME = "frd2012_events.csv.gz"
URL = (
    "https://raw.githubusercontent.com/fdvorak/stratEst/"
    "c05aae64eadc8f5e2bbf8b98b14b884f5b393be7/data/data.FRD2012.rda"
)
SHA256 = "094caa0200e2a4edbeac9ebc30168fd7fb83a561dff22e06363b61cb0643804b"

_CHOICES = {"c": "help", "d": "no_help"}
_ERRORS = {"0": "0", "0.0625": "16", "0.125": "8"}


def find_file() -> Path:
    """Path of the data: in the folder named by ``PROSOCIAL_DATA``; without one in the download cache, or fetched.

    Raises
    ------
    InputError
        If the folder that is named does not have it, or it cannot be fetched, with what to do.
    """
    folder = os.environ.get("PROSOCIAL_DATA")
    if folder:
        if not Path(folder).is_dir():
            raise located("environment variable PROSOCIAL_DATA", folder, "an existing folder")
        for name in (FILE_NAME, EVENTS_NAME):
            if (Path(folder) / name).is_file():
                return Path(folder) / name
        wanted = f"a folder that holds {FILE_NAME} or {EVENTS_NAME}; unset the variable to have it fetched"
        raise located("environment variable PROSOCIAL_DATA", folder, wanted)
    return _fetch()


def local_files() -> tuple[Path, ...]:
    """Where the data may lie on this machine, whether they do or not."""
    folder = os.environ.get("PROSOCIAL_DATA")
    given = [Path(folder) / name for name in (FILE_NAME, EVENTS_NAME)] if folder else []
    return (*given, _downloads() / FILE_NAME)


def _downloads() -> Path:
    return cache_folder().parent.parent / "downloads"


def _fetch() -> Path:
    import pooch  # imports an HTTP client, which nothing else needs

    pooch.get_logger().setLevel("WARNING")
    try:
        return Path(pooch.retrieve(URL, known_hash=f"sha256:{SHA256}", fname=FILE_NAME, path=_downloads()))
    except (OSError, ValueError) as error:
        reason = str(error).split("\n", 1)[0]
        if len(reason) > 120:
            reason = reason[:117] + "..."
        raise InputError(
            f"frd2012: not bundled, and fetching it failed ({type(error).__name__}: {reason}). Download {URL} on a "
            f"machine with a connection, put it in a folder, and set PROSOCIAL_DATA to that folder"
        ) from None


def read_frd2012(path: str | Path, protocol: Protocol = PUBLISHED) -> EventLog:
    """Read the R file and convert it.

    Raises
    ------
    InputError
        If the file is not the pinned one (SHA-256), or the protocol does not have the published names.
    """
    import rdata

    found = hashlib.sha256(Path(path).read_bytes()).hexdigest()
    if found != SHA256:
        raise located(f"{path}, SHA-256", found, f"{SHA256}: this is not the pinned file")
    constructors = dict(rdata.conversion.DEFAULT_CLASS_MAP)
    constructors["stratEst.data"] = rdata.conversion.dataframe_constructor
    content = rdata.read_rda(path, constructor_dict=constructors)
    return EventLog.from_frame(events_frame(content["data.FRD2012"]), protocol, str(path))


def events_frame(periods: Any) -> pd.DataFrame:
    """Convert one row a period (`id, game, period, bc, error, choice, last.other`) to one row an event.

    Parameters
    ----------
    periods : pandas.DataFrame

    Returns
    -------
    pandas.DataFrame
        Columns of the event log, sorted by participant, sequence (the match) and k. The condition
        ``bcB_eN`` is benefit/cost B and execution error 1/N (``e0``: none).
    """
    periods = periods.sort_values(["id", "game", "period"], kind="stable")
    condition = "bc" + periods["bc"].astype(str) + "_e" + periods["error"].astype(str).map(_ERRORS)
    own = pd.DataFrame(
        {
            "study": STUDY,
            "participant": periods["id"].astype(np.int64),
            "condition": condition,
            "sequence": periods["game"].astype(np.int64),
            "k": 2 * (periods["period"].astype(np.int64) - 1),
            "mode": "robot_needs_help",
            "action": "no_signal",
            "observation": periods["choice"].astype(str).map(_CHOICES),
        }
    )
    later = periods["period"].to_numpy() > 1
    partner = own[later].assign(
        k=own["k"] - 1,
        mode="human_needs_help",
        action=periods["last.other"].astype(str).map(_CHOICES),
        observation="none",
    )
    events = pd.concat([own, partner])
    return events.sort_values(["participant", "sequence", "k"], kind="stable", ignore_index=True)
