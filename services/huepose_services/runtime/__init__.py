"""What every worker uses: configuration, zenoh session, loop, health, supervisor."""
