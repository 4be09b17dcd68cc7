"""The parts of the rule an obstacle lives by; `server.rules` puts them together. Pure."""
