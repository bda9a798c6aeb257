"""Settings and panels. Panels only draw."""
