"""What does the bristle look like as hexahedra, and is that mesh sound?"""
