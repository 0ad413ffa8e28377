"""How time passes: marching through an impact, and exact free flight between impacts."""
