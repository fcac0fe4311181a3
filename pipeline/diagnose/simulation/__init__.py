"""The simulation of a session: every feature predicted from film, rig and what mechanisms add."""
