"""Settings shared by the tests: Hypothesis profiles, threads, and the folder of the oracles on the path."""

import os
import sys
from pathlib import Path

# The tests run side by side: threads of linear algebra would only be in each other's way. Read when numpy loads.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numba
from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))

# The same examples at every run; HYPOTHESIS_PROFILE=explore looks further.
settings.register_profile("compiled", deadline=None, derandomize=True, max_examples=100)
settings.register_profile("interpreted", deadline=None, derandomize=True, max_examples=15)
settings.register_profile("explore", deadline=None, max_examples=1000, print_blob=True)
settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE") or ("interpreted" if numba.config.DISABLE_JIT else "compiled")
)
