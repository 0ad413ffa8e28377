"""The command that closes the loop: from a dataset to verdict.json and its page."""
