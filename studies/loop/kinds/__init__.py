"""Kinds of measured data, a folder each: how it is read, and what of it the model predicts."""
