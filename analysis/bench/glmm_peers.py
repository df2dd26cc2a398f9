"""The peers of the mixed model's benchmark: how each is asked for a fit, and what it says of it.

lme4 runs in one R process that stays alive, so that its fits and ours are made in turn; R's start is not counted.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import warnings
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
import pandas as pd
from scipy import sparse

R_SERVER = """
suppressMessages(library(lme4))
requests <- file("stdin"); open(requests)
data <- NULL; loaded <- ""
repeat {
  line <- readLines(requests, n = 1)
  if (length(line) == 0) break
  request <- strsplit(line, "\\t")[[1]]
  if (request[1] != loaded) { data <- read.csv(request[1]); loaded <- request[1] }
  invisible(gc())
  setTimeLimit(cpu = as.numeric(request[4]), transient = TRUE)
  before <- proc.time()
  fit <- try(suppressWarnings(suppressMessages(
    glmer(as.formula(request[2]), data, family = binomial, nAGQ = as.integer(request[3]))
  )), silent = TRUE)
  seconds <- sum((proc.time() - before)[c("user.self", "sys.self", "user.child", "sys.child")])
  setTimeLimit()
  if (inherits(fit, "try-error")) {
    cat("failed\\t", gsub("[\\t\\n]", " ", as.character(fit)), "\\n", sep = "")
  } else {
    cat(format(c(seconds, logLik(fit), attr(VarCorr(fit)[[1]], "stddev")), digits = 15), sep = "\\t")
    cat("\\n")
  }
  flush(stdout())
}
"""


PATIENCE = 60.0
"""CPU seconds after which a fit by lme4 is given up."""


class PeerFailed(Exception):
    """A peer gave no fit; the message is what it said."""


class OutOfPatience(PeerFailed):
    """A peer took longer than `PATIENCE`."""


@dataclass(frozen=True)
class Fitted:
    """What a peer says of a fit.

    Attributes
    ----------
    log_likelihood : float
        NaN where the method has none.
    sd : float
        Of the random intercept.
    seconds : float
        CPU seconds by the peer's own clock; NaN where it runs in this process.
    """

    log_likelihood: float
    sd: float
    seconds: float = float("nan")


@dataclass(frozen=True)
class Case:
    """One data set with its formula.

    Attributes
    ----------
    name : str
    frame : DataFrame
        One row a response; the groups are `group`.
    outcome : str
    terms : tuple of str
        Columns of covariates.
    group : str
    """

    name: str
    frame: pd.DataFrame
    outcome: str
    terms: tuple[str, ...]
    group: str

    @property
    def formula(self) -> str:
        """The model in lme4's spelling, which all but statsmodels read."""
        return f"{self.outcome} ~ {' + '.join(self.terms)} + (1 | {self.group})"


def lme4_version() -> str | None:
    """Versions of lme4 and R in words; None where R or lme4 is absent."""
    if shutil.which("Rscript") is None:
        return None
    ask = 'cat("lme4", as.character(packageVersion("lme4")), "on R", as.character(getRversion()))'
    try:
        done = subprocess.run(["Rscript", "-e", ask], capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout.strip() if done.returncode == 0 else None


class Glmer:
    """lme4's glmer in an R process of its own, as a context."""

    def __enter__(self) -> Glmer:
        self._folder = tempfile.TemporaryDirectory()
        script = Path(self._folder.name) / "server.R"
        script.write_text(R_SERVER, encoding="utf-8")
        one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            ["Rscript", "--vanilla", str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, text=True, env=os.environ | one,
        )  # fmt: skip
        self._files: dict[int, Path] = {}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with suppress(BrokenPipeError):
                    stream.close()
        self._folder.cleanup()

    def fit(self, case: Case, nodes: int) -> Fitted:
        """One fit with nAGQ = nodes and lme4's own settings otherwise; reading the table is not counted.

        Raises
        ------
        OutOfPatience
            After `PATIENCE`.
        PeerFailed
            Where R fails otherwise.
        """
        path = self._files.get(id(case.frame))
        if path is None:
            path = Path(self._folder.name) / f"{len(self._files)}.csv"
            case.frame[[case.outcome, *case.terms, case.group]].to_csv(path, index=False)
            self._files[id(case.frame)] = path
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(f"{path}\t{case.formula}\t{nodes}\t{PATIENCE:g}\n")
            self._process.stdin.flush()
        except BrokenPipeError as error:
            raise PeerFailed("R has ended") from error
        answer = self._process.stdout.readline().rstrip("\n").split("\t")
        if len(answer) != 3:
            said = " ".join(answer).strip() or "R has ended"
            raise (OutOfPatience if "CPU time limit" in said else PeerFailed)(said)
        seconds, value, sd = map(float, answer)
        return Fitted(value, sd, seconds)


def version(package: str) -> str | None:
    """Name and version of an installed package, else None."""
    try:
        return f"{package} {metadata.version(package)}"
    except metadata.PackageNotFoundError:
        return None


def fit_glmm(case: Case, nodes: int) -> Fitted:
    """One fit by the package `glmm` with its own settings."""
    glmm = import_module("glmm")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = glmm.fit(case.frame, case.formula, family="binomial", nagq=nodes)
    return Fitted(float(fit.loglik), float(np.sqrt(np.ravel(fit.tau2)[0])))


def fit_variational(case: Case) -> Fitted:
    """One fit by statsmodels' BinomialBayesMixedGLM: another method, without a likelihood to compare.

    Its default search keeps a dense matrix of twice the number of groups squared (80 GB for 50,000 groups); the
    limited-memory variant of the same search is used instead, which is faster for few groups, too.
    """
    from statsmodels.genmod.bayes_mixed_glm import BinomialBayesMixedGLM

    frame = case.frame
    code, labels = pd.factorize(frame[case.group])
    n = len(frame)
    members = sparse.csr_matrix((np.ones(n), (np.arange(n), code)), shape=(n, len(labels)))
    design = np.column_stack([np.ones(n), *(frame[term].to_numpy(float) for term in case.terms)])
    model = BinomialBayesMixedGLM(
        frame[case.outcome].to_numpy(float), design, members, np.zeros(len(labels), dtype=int)
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit: Any = model.fit_vb(fit_method="L-BFGS-B", rng=1)
    return Fitted(float("nan"), float(np.exp(fit.vcp_mean[0])))
