"""Rough, composite surfaces that bristles land on, drawn at random or measured."""
