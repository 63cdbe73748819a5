"""The checks of one candidate fix: comparison, tests, verification, order and history of fixes."""
