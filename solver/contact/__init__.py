"""How a tip pushes back: contact laws, and the ways of enforcing them."""
