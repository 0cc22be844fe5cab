"""What `huepose doctor` looks at. Each check looks at one thing, changes nothing, and says what to do."""
