// What can be shown of a volume, and the colours of its numbers.

// Matplotlib's "inferno" by nine of its colours: its brightness grows evenly, so that it reads without colours, too.
const INFERNO = [ [ 0, 0, 4 ], [ 31, 12, 72 ], [ 85, 15, 109 ], [ 136, 34, 106 ], [ 186, 54, 85 ], [ 227, 89, 51 ], [ 249, 140, 10 ], [ 249, 201, 50 ], [ 252, 255, 164 ] ];

/** sRGB bytes of a share from 0, good, to 1, bad. */
export function heat( share ) {

	const at = Math.min( 1, Math.max( 0, share || 0 ) ) * ( INFERNO.length - 1 );
	const k = Math.min( INFERNO.length - 2, Math.floor( at ) );
	return INFERNO[ k ].map( ( from, c ) => from + ( at - k ) * ( INFERNO[ k + 1 ][ c ] - from ) );

}

/** 256 colours, RGBA, for a texture. */
export const heatTable = () => Uint8Array.from( { length: 1024 }, ( _, k ) => k % 4 === 3 ? 255 : heat( ( k >> 2 ) / 255 )[ k % 4 ] );

/** A figure of a node that has none; and its colour. */
export const UNKNOWN = - 1;
const GREY = [ 128, 128, 128 ];

/** sRGB bytes of a figure. */
export const colourOf = ( range, figure ) => figure <= UNKNOWN ? GREY : heat( shareOf( range, figure ) );

export const luminance = ( [ r, g, b ] ) => 0.2126 * r + 0.7152 * g + 0.0722 * b;

export const srgb = ( v ) => 255 * ( v <= 0 ? 0 : v <= 0.0031308 ? 12.92 * v : Math.min( 1, 1.055 * v ** ( 1 / 2.4 ) - 0.055 ) );

const percent = ( v ) => `${ + ( 100 * v ).toPrecision( 2 ) } %`;

/**
 * Everything that the view can show. `key`: the figure of nodes; `light`: surfaces and nodes show light itself. `to`: the
 * number at the bad end of the scale, or null for the 98th percentile of what there is.
 */
export const MODES = [
	{ id: 'lit', name: 'Light', light: true, about: 'the level in the light of the volume, as an engine shows it' },
	{ id: 'white', name: 'Irradiance', light: true, about: 'irradiance / π: the same light on white surfaces' },
	{ id: 'noise', key: 'noise', name: 'Noise', text: percent, from: 0, to: null, about: 'one standard error of irradiance; more samples lessen it' },
	{ id: 'systematic', key: 'systematic', name: 'Systematic error', text: percent, from: 0, to: null, about: 'what more samples do not take away' },
	{ id: 'seen', key: 'seen', name: 'Seen error', text: percent, from: 0, to: null, about: 'how wrong light is between nodes, where an engine reads it, at the worst of the places where that was measured' },
	{ id: 'coverage', key: 'coverage', name: 'Coverage', text: percent, from: 1, to: 0, about: 'the share of what a node sees that some probe has seen' },
	{ id: 'validity', key: 'validity', name: 'Filled nodes', text: ( v ) => v < 0.5 ? 'filled' : 'baked', from: 1, to: 0, about: 'nodes without light of their own take it from their neighbours' },
	{ id: 'cell_size', key: 'cell_size', name: 'Cell size', text: ( v ) => `${ v.toFixed( 0 ) } wide`, from: 1, to: 8, about: 'how coarse the sparse grid is, in places of the finest grid' },
	{ id: 'difference', key: 'difference', name: 'Difference', text: percent, from: 0, to: null, about: 'how far irradiance differs between the two volumes, over the larger of the second one’s own and a tenth of its median' },
];

/** The share on the scale, 0 good to 1 bad. */
export const shareOf = ( { from, to }, value ) => to === from ? 0 : ( value - from ) / ( to - from );

/** A number with one digit that is not under a value: the end of a scale. */
export function roundUp( value ) {

	if ( ! ( value > 0 ) ) return 0.01;
	const step = 10 ** Math.floor( Math.log10( value ) );
	return Math.ceil( value / step - 1e-9 ) * step;

}

/** The value under which a share of all numbers lies. */
export function quantile( values, share ) {

	const sorted = Float32Array.from( values ).sort();
	return sorted.length ? sorted[ Math.min( sorted.length - 1, Math.floor( share * sorted.length ) ) ] : 0;

}
