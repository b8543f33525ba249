// All words of the page: English, German, Czech. What the vehicle says (events, names) stays as it is.
export const LANGUAGES = ["en", "de", "cs"];

const TABLE = {
  across: ["across", "quer", "napříč"],
  along: ["along", "längs", "podél"],
  bytes: ["bytes/s", "Bytes/s", "bajty/s"],
  connected: ["live", "live", "živě"],
  connecting: ["connecting …", "verbinde …", "připojuji …"],
  cpu: ["CPU", "CPU", "CPU"],
  course: ["Course", "Verlauf", "Průběh"],
  decoded: ["decoded", "gelesen", "přečteno"],
  device: ["device", "Gerät", "zařízení"],
  devices: ["Devices", "Geräte", "Zařízení"],
  disconnected: ["no connection, trying again", "keine Verbindung, neuer Versuch", "bez spojení, zkouším znovu"],
  doors_open: ["doors open", "Türen offen", "dveře otevřené"],
  estimate: ["estimate", "Schätzung", "odhad"],
  events: ["Events", "Ereignisse", "Události"],
  fix_DEAD_RECKONING: ["dead reckoning", "Koppelnavigation", "výpočtem"],
  fix_FIX_2D: ["2D", "2D", "2D"],
  fix_FIX_3D: ["3D", "3D", "3D"],
  fix_GNSS_AND_DEAD_RECKONING: ["3D + DR", "3D + DR", "3D + DR"],
  fix_NO_FIX: ["no fix", "kein Ort", "bez polohy"],
  fix_TIME_ONLY: ["time only", "nur Zeit", "jen čas"],
  fixes: ["GNSS fixes", "GNSS-Orte", "polohy GNSS"],
  follow: ["Follow (f)", "Folgen (f)", "Sledovat (f)"],
  gnss: ["GNSS", "GNSS", "GNSS"],
  grade: ["Slope", "Steigung", "Sklon"],
  heading: ["Heading", "Richtung", "Směr"],
  heading_up: ["Heading up (h)", "Fahrtrichtung oben (h)", "Směr jízdy nahoru (h)"],
  height: ["height", "Höhe", "výška"],
  in_time: ["in {0} s", "in {0} s", "za {0} s"],
  innovation: ["Innovation, σ", "Innovation, σ", "Inovace, σ"],
  keys_help: [
    "Keys: f follow, h heading up, t dark or light, 1, 2, 3 length of the strips. This page only looks: it sends nothing to the vehicle.",
    "Tasten: f folgen, h Fahrtrichtung oben, t dunkel oder hell, 1, 2, 3 Länge der Streifen. Diese Seite schaut nur zu: sie sendet nichts an das Fahrzeug.",
    "Klávesy: f sledovat, h směr jízdy nahoru, t tmavý nebo světlý vzhled, 1, 2, 3 délka průběhu. Stránka se jen dívá: vozidlu nic neposílá.",
  ],
  language: ["Language", "Sprache", "Jazyk"],
  limit: ["protection level", "Schutzgrenze", "ochranná mez"],
  line: ["Line", "Linie", "Linka"],
  lost: ["lost", "verloren", "ztraceno"],
  map: ["Map", "Karte", "Mapa"],
  map_label: ["Map of the tracks with the vehicle", "Gleiskarte mit dem Fahrzeug", "Mapa kolejí s vozidlem"],
  map_source: ["map", "Karte", "mapa"],
  memory: ["memory", "Speicher", "paměť"],
  mode_DEAD_RECKONING: ["dead reckoning", "Koppelnavigation", "navigace výpočtem"],
  mode_HEADING_UNKNOWN: ["heading unknown", "Richtung unbekannt", "směr neznámý"],
  mode_STARTING: ["starting", "beginnt", "začíná"],
  mode_TRACKING: ["tracking", "Ortung", "sledování"],
  mode_none: ["no estimate", "keine Schätzung", "bez odhadu"],
  next_stop: ["next stop", "nächster Halt", "příští zastávka"],
  no_events: ["none yet", "noch keine", "zatím žádné"],
  no_network: [
    "No track network: start with --net FILE to see the rails.",
    "Kein Gleisnetz: mit --net DATEI starten, um die Gleise zu sehen.",
    "Bez kolejové sítě: spusťte s --net SOUBOR, aby byly vidět koleje.",
  ],
  node: ["node", "Knoten", "uzel"],
  nodes: ["Nodes", "Knoten", "Uzly"],
  now: ["Now", "Jetzt", "Nyní"],
  of_map: ["off the map", "nicht auf der Karte", "mimo mapu"],
  problems: ["{0} in trouble", "{0} gestört", "{0} v poruše"],
  rejected: ["rejected", "verworfen", "odmítnuto"],
  refused: ["refused", "abgelehnt", "odmítnuto"],
  satellites: ["Satellites", "Satelliten", "Družice"],
  satellites_used: ["{0} satellites", "{0} Satelliten", "{0} družic"],
  sigma: ["Deviation, m", "Abweichung, m", "Odchylka, m"],
  speed: ["Speed", "Geschwindigkeit", "Rychlost"],
  state: ["state", "Zustand", "stav"],
  stop_distance: ["stops within", "Anhalteweg", "zastaví do"],
  theme: ["Dark or light (t)", "Dunkel oder hell (t)", "Tmavý/světlý (t)"],
  time: ["time", "Zeit", "čas"],
  track: ["Track", "Gleis", "Kolej"],
  trail: ["way so far", "bisheriger Weg", "dosavadní dráha"],
  used: ["{0} of {1} used", "{0} von {1} genutzt", "{0} z {1} použito"],
  vehicle: ["vehicle and protection level", "Fahrzeug und Schutzgrenze", "vozidlo a ochranná mez"],
  wheels: ["wheels", "Räder", "kola"],
  within: ["within", "höchstens", "nejvýš"],
  window: ["Length of the strips", "Länge der Streifen", "Délka průběhu"],
};

let column = 0;

export function choose(language) {
  column = Math.max(0, LANGUAGES.indexOf(language));
  document.documentElement.lang = LANGUAGES[column];
}

export function text(key, ...values) {
  const words = TABLE[key];
  if (words === undefined) return key;
  return words[column].replace(/\{(\d)\}/g, (_, n) => String(values[Number(n)]));
}

export function known(key) {
  return key in TABLE;
}

export function decimals(value, digits = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return value.toLocaleString(LANGUAGES[column], {
    minimumFractionDigits: digits,
    maximumFractionDigits: digits,
    useGrouping: false,
  });
}
