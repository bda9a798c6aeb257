"""The sidebar: panels, lists and menus. Panels only draw."""
