"""DataCite metadata (kernel 4.5, JSON) of a deposit, from the keys of its YAML files; keys not given are omitted."""

from __future__ import annotations

from typing import Any

from compasslib.archive.attributes import Site
from compasslib.archive.provenance import software
from compasslib.config.cruise import Cruise

FILE = "datacite.json"
METHOD = "10.1175/JTECH-D-14-00043.1"  # von Appen (2015)


def describe(cruise: Cruise, *, title: str, published: str) -> dict[str, Any]:
    """Compose the DataCite metadata of a cruise.

    Args:
        cruise: its attributes must include those that a deposit requires.
        published: date of the results, ISO 8601.
    """
    given = {key: str(value) for key, value in cruise.options.attributes.items()}
    affiliation = [{"name": given["institution"]}]
    creator = {"name": given["principal_investigator"], "nameType": "Personal", "affiliation": affiliation}
    if orcid := given.get("principal_investigator_orcid"):
        scheme = {"nameIdentifierScheme": "ORCID", "schemeUri": "https://orcid.org/"}
        creator["nameIdentifiers"] = [{"nameIdentifier": orcid, **scheme}]
    moorings = {name.partition("/")[0]: mooring for name, mooring in cruise.moorings.items()}
    places = []
    for name, mooring in moorings.items():
        longitude = Site(name, mooring.latitude, mooring.longitude).signed_longitude()
        point = {"pointLatitude": mooring.latitude, "pointLongitude": longitude}
        places.append({"geoLocationPlace": name, "geoLocationPoint": point})
    spans = dict.fromkeys(f"{mooring.start:%Y-%m-%d}/{mooring.end:%Y-%m-%d}" for mooring in moorings.values())
    dates = [{"date": span, "dateType": "Collected"} for span in spans]
    terms, abstract = given["license"], given.get("summary", f"{title}. Processed by {software()}.")
    method = {"relatedIdentifier": METHOD, "relatedIdentifierType": "DOI", "relationType": "References"}
    described = {
        "schemaVersion": "http://datacite.org/schema/kernel-4",
        "types": {"resourceTypeGeneral": "Dataset", "resourceType": "Moored current records with corrected headings"},
        "titles": [{"title": title}],
        "creators": [creator],
        "publisher": {"name": given["institution"]},
        "publicationYear": published[:4],
        "dates": [*dates, {"date": published, "dateType": "Created"}],
        "rightsList": [{"rights": terms, **({"rightsUri": terms} if "://" in terms else {})}],
        "subjects": [{"subject": "ocean currents"}, {"subject": "compass deviation"}],
        "descriptions": [{"description": abstract, "descriptionType": "Abstract"}],
        "relatedIdentifiers": [method],
        "geoLocations": places,
        "formats": ["application/x-netcdf", "application/json", "text/csv"],
        **({"doi": given["doi"]} if "doi" in given else {}),
    }
    return {key: value for key, value in described.items() if value}
