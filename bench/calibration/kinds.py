"""Kinds of good data sets; each name says what is not ideal about it."""

from bench.calibration.synthetic import Design

CLEAN = {
    "clean": Design(led_offset_prior_sd=0.0),
    "clean, position noise": Design(led_offset_prior_sd=0.0, sigma_px=0.02, sigma_m=1e-3),
    "clean, image noise": Design(led_offset_prior_sd=0.0, sigma_px=0.3, sigma_m=5e-5),
    "clean, 0.5 px, 20 poses": Design(poses=20, led_offset_prior_sd=0.0, sigma_px=0.5),
    "clean, 1 px": Design(led_offset_prior_sd=0.0, sigma_px=1.0),
    "clean, 15 poses": Design(poses=15, led_offset_prior_sd=0.0),
    "clean, 80 poses": Design(poses=80, led_offset_prior_sd=0.0),
    "clean, 1 camera": Design(cameras=1, led_offset_prior_sd=0.0),
    "clean, 5 cameras": Design(cameras=5, poses=25, led_offset_prior_sd=0.0),
}
"""The statistical limit is to be met, and OpenCV not to be lost against by more than 3 %."""

HARD = {
    "10 % outliers": Design(outlier_share=0.1, missing_share=0.05, led_offset_prior_sd=0.0),
    "20 % outliers": Design(outlier_share=0.2, missing_share=0.1, led_offset_prior_sd=0.0),
    "20 % outliers, LED": Design(outlier_share=0.2, missing_share=0.05, led_offset_prior_sd=0.05),
    "20 % outliers, LED, 15 poses": Design(poses=15, outlier_share=0.2, led_offset_prior_sd=0.05),
    "20 % outliers, LED, 0.5 px": Design(outlier_share=0.2, led_offset_prior_sd=0.05, sigma_px=0.5),
    "LED": Design(led_offset_prior_sd=0.05),
    "anisotropic": Design(anisotropy=5.0, sigma_m=1.5e-3, led_offset_prior_sd=0.0),
    "heteroscedastic": Design(heteroscedasticity=5.0, sigma_m=1e-3, led_offset_prior_sd=0.0),
    "joints": Design(joint_offset_prior_sd=5e-3, led_offset_prior_sd=0.0),
    "everything": Design(
        outlier_share=0.15, missing_share=0.05, led_offset_prior_sd=0.02, joint_offset_prior_sd=3e-3, anisotropy=4.0,
        heteroscedasticity=3.0,
    ),
    "everything, 3 cameras": Design(
        cameras=3, poses=30, outlier_share=0.15, missing_share=0.05, led_offset_prior_sd=0.02,
        joint_offset_prior_sd=3e-3, anisotropy=4.0, heteroscedasticity=3.0,
    ),
}  # fmt: skip
"""OpenCV is to be beaten by a tenth, and the limit of the inliers to be met."""
