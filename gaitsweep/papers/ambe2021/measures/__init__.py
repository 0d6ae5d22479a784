"""The measures of Ambe et al. 2021's claims: its equations, its theory, its simulations."""
