"""What holds for all tests."""

import os
import signal

# Before numpy is loaded, here and in every process that tests start: several workers with as many threads of linear
# algebra as processors each wait for one another (an hour of `independent_offset`: 146 s for 8 s).
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

from hypothesis import settings

# Whoever starts the tests in the background of a shell has Ctrl-C ignored, and so would all processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine takes any time over an example; what must be quick has a benchmark.
settings.register_profile("camber", deadline=None)
settings.load_profile("camber")
