"""Contact: surfaces as quadrature points, who is close to whom, and stiffnesses."""
