"""The silicone-and-acrylic laboratory `auk`: a truth rig."""
