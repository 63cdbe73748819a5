"""Faults that all fixes share: fixes led away, bases off, and drives without fault.

No usable position may be beyond its level. Belongs here: the drives, the faults, the figures and their page. Not here:
faults of single fixes (`lab`).
"""
