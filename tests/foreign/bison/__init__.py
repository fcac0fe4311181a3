"""Truth rig `bison`: an acrylic film laboratory with a voice coil and a laser."""
