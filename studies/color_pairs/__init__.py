"""What colour pairs are worth, measured step by step on rendered views where the answer is known."""
