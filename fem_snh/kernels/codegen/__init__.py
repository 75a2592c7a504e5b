"""C code generation: from a material's sympy expression to the source of its kernels."""
