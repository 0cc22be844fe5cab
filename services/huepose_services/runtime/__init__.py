"""What every worker stands on: configuration, zenoh session, loop, health, supervisor."""
