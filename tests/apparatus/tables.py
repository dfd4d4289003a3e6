"""A table for air hockey every number of which differs from its default."""

from airpuck.craft.table import AirHockey, Contact, Mallet, Puck, Table

EVERYTHING = AirHockey(
    table=Table(length_m=1.948, width_m=1.038, restitution=0.6, friction=0.2, goal_width_m=0.25),
    puck=Puck(
        radius_m=0.03,
        mass_kg=0.02,
        inertia_kg_m2=1e-5,
        drag_1_s=0.1,
        spin_drag_1_s=0.3,
        rail=Contact(restitution=0.7, grip=0.5, friction=0.1),
        mallet=Contact(restitution=0.6, grip=0.4, friction=0.2),
        craft=Contact(restitution=0.5, grip=0.3, friction=0.4),
        standard_error={"drag_1_s": 0.01, "rail.restitution": 0.002},
    ),
    mallet=Mallet(radius_m=0.05, speed_m_s=3.0, acceleration_m_s2=20.0),
)
