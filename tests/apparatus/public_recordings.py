"""Recordings of the public dataset, and the paper's numbers for them."""

TRAINING = "2023_10_18-11_28_12_sysid_h1_old"
VALIDATION = "2023_11_22-11_57_44_sysid_h1_old"
BLUE = "2024_03_05-16_12_50_sysid_h1_blue"

#: RMSE at 0.2 s with published parameters: x, y [mm], γ [rad] (table:prediction_error).
TABLE_2 = {
    "M0": (16.19, 15.72, 0.5008),
    "M1": (15.08, 14.98, 0.4951),
    "M2": (12.87, 11.39, 0.3910),
    "M3": (10.84, 9.76, 0.3871),
    "M4": (10.76, 9.56, 0.3874),
}
