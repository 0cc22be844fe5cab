"""Hard moments for a tracker, drawn by the project's own renderer, and what came of them."""
