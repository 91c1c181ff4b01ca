"""Stand-ins for vendors' libraries and services, with an arm behind them that obeys physics, or misbehaves on command."""
