"""Truth rig crane: a small laboratory with compact sessions."""
