"""Contact of the tip with the ground: contact laws, friction, and methods of enforcing them."""
