"""What holds for all tests."""

import signal

from hypothesis import settings

# Whoever starts the tests in the background of a shell has Ctrl-C ignored, and so would all processes they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A busy machine takes any time over an example; what must be quick has a benchmark.
settings.register_profile("camber", deadline=None)
settings.load_profile("camber")
