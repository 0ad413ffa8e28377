"""Impacts, noises and unlisted shapes that share nothing with what the loop fits to them."""
