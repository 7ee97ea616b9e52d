"""Settings that every test shares; no fixture that only some of them need.

How hard hypothesis searches is chosen by HYPOTHESIS_PROFILE: dev, ci or nightly.
"""

import os

from hypothesis import settings

# No deadlines: a first call traces and compiles, and on a busy machine a slow example is no failure.
settings.register_profile("dev", max_examples=25, deadline=None)
settings.register_profile("ci", max_examples=50, derandomize=True, deadline=None)
settings.register_profile("nightly", max_examples=5000, deadline=None)

settings.load_profile(
    os.environ.get("HYPOTHESIS_PROFILE") or ("ci" if os.environ.get("CI") == "true" else "dev")
)
