"""The `huepose` command."""
