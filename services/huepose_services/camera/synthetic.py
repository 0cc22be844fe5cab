"""The built-in scene as a camera."""
