"""How properties are tried, wherever nothing else is said."""

from hypothesis import settings

# A busy machine takes any time over an example; what must be quick has a benchmark.
settings.register_profile("camber", deadline=None)
settings.load_profile("camber")
