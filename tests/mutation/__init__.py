"""Mutation testing of the kernels: does any test notice when a line of them says something else?"""
