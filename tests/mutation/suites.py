"""Which tests are meant to pin which kernels."""

from __future__ import annotations

KERNELS = "tests/models/test_kernels_by_hand.py"
BOUNDS = "tests/models/planning/test_bounds_by_hand.py"
QUADRATURE = "tests/models/test_quadrature_by_hand.py"

SUITES: dict[str, list[str]] = {
    "models/forward_backward.py": [KERNELS],
    "models/em_kernel.py": [KERNELS],
    "models/hmm_density.py": [KERNELS, "tests/models/test_hmm_density.py"],
    "models/draw_kernels.py": [KERNELS],
    "models/planning/fast_informed_bound.py": [BOUNDS],
    "models/planning/vectors.py": [BOUNDS, "tests/models/planning/test_vectors.py"],
    "models/planning/step_kernel.py": [BOUNDS, "tests/models/planning/test_step_kernel.py"],
    "models/planning/belief_tree.py": [BOUNDS],
    "models/planning/node_backups.py": [BOUNDS],
    "models/glmm_kernel.py": [QUADRATURE, "tests/models/test_glmm_kernel.py"],
    "models/glmm_nodes.py": [QUADRATURE],
    "models/glmm_exact.py": [QUADRATURE],
}
"""Tests of every file, relative to the checkout: small ones, as kernels are interpreted."""
