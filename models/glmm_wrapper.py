"""The results with the names of parameters on their vectors and matrices, as statsmodels hands them out."""

from __future__ import annotations

from typing import Any, ClassVar

import pandas as pd
from statsmodels.base import model as base
from statsmodels.base import wrapper as wrap

from models.glmm_arguments import positions_of
from models.glmm_results import LogisticMixedResults


class LogisticMixedResultsWrapper(base.LikelihoodResultsWrapper):
    """Results whose vectors and matrices carry the names of parameters."""

    _wrap_attrs = wrap.union_dicts(
        base.LikelihoodResultsWrapper._wrap_attrs, {"fe_params": ("generic_columns", "xnames")}
    )

    _wrap_methods: ClassVar = {
        k: v for k, v in base.LikelihoodResultsWrapper._wrap_methods.items() if k not in ("cov_params", "conf_int")
    }

    def __repr__(self) -> str:
        """As the results inside say it."""
        return repr(self._results)

    def conf_int(self, *args: Any, **kwargs: Any) -> Any:
        """See `LogisticMixedResults.conf_int`; named by parameters, also where only some are wanted."""
        plain = self._results.conf_int(*args, **kwargs)
        names = list(self._results.model.data.param_names)
        cols = args[3] if len(args) > 3 else kwargs.get("cols")
        rows = names if cols is None else [names[i] for i in positions_of(cols, names)]
        return pd.DataFrame(plain, index=rows)

    def cov_params(self, *args: Any, **kwargs: Any) -> Any:
        """See `LogisticMixedResults.cov_params`; named by parameters, but of linear combinations plain.

        statsmodels' wrapper gives combinations the parameters' names, and fails where they are fewer.
        """
        plain = self._results.cov_params(*args, **kwargs)
        names = list(self._results.model.data.param_names)
        given = dict(zip(("r_matrix", "column"), args, strict=False)) | kwargs
        if any(given.get(name) is not None for name in ("r_matrix", "column")):
            return plain
        return pd.DataFrame(plain, index=names, columns=names)


wrap.populate_wrapper(LogisticMixedResultsWrapper, LogisticMixedResults)
