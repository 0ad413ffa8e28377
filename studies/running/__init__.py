"""Execution of cases: over ranks, journalled, resumed."""
