"""Integer ambiguity resolution: LAMBDA, ratio test, partial resolution, the fixed solution, continuity."""
