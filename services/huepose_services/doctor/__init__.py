"""The checks of `huepose doctor`. Each checks one thing, changes nothing, and says what to do."""
