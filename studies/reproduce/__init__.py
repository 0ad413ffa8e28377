"""Sections of the page of `bristle reproduce`, a question each."""
