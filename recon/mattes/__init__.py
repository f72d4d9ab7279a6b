"""Mattes: plate difference or brightness, trimap, closed form or a network, and which frames look wrong."""
