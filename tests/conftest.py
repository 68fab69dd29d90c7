"""What all tests share: random cases are drawn from a fixed seed, so that a suite that has passed
passes again.  ``HYPOTHESIS_PROFILE=random pytest`` looks for new ones."""

import os

from hypothesis import settings

settings.register_profile("fixed", derandomize=True, deadline=None, database=None)
settings.register_profile("random", deadline=None, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fixed"))
