// The page: panels first, then the news.

import { control } from "./controls.js";
import { curves } from "./curves.js";
import { broken, lists } from "./lists.js";
import { pictures } from "./maps.js";
import { listen } from "./stream.js";

lists();
curves();
pictures();
control();
listen(broken);
